"""Models in other languages: C, FMI, a single Python file, MATLAB and GNU Octave."""
