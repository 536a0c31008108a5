/* What one instance of an FMU keeps. */
#ifndef QUASI_FMU_INSTANCE_H
#define QUASI_FMU_INSTANCE_H

typedef struct {
    double inverse[9]; /* of the inertia */
    double target[4];  /* rotor speeds that the rotors moved to in the last step, rad/s */
    int stepped;       /* whether there was one */
    int count;         /* commands that are remembered for the delay of the rotors: */
    double when[MEMORY_ROWS], command[MEMORY_ROWS][4];
} Memory;

typedef struct {
    double value[VALUES]; /* by value reference */
    double time;
    int stale; /* whether outputs are to be computed anew */
    int begun; /* whether initialisation has ended */
    Memory memory;
} Data;

typedef struct {
    Data data;
    fmi2CallbackFunctions functions;
    int co_simulation;
    char name[256];
} Instance;

#endif
