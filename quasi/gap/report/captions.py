"""What the figures of a gap show, by name."""

CAPTIONS = {
    "glance": "Left: the error of the model where it falls most, before (pale red) and after (blue) the extension, "
    "with standard errors, compared and held-out flights together. Right: a held-out flight (black) and what the "
    "simulation makes of its rotor speeds, in a typical window: that of the median gain, where windows count by how "
    "much the extension changes them; the best and the worst one stand below. Where causes are named that all flights "
    "have, the model's own terms were fitted anew with them, "
    "and the gain is that of both.",
    "trim": "Thrust that each rotor is asked for in steady flight, by its speed or command, relative to the mean of "
    "the reference flights: each flight, and the change with its 95 % interval, the spread between sessions included.",
    "overlays": "Simulated from measured states with measured rotor speeds, before (pale red) and after (blue) the "
    "extension, with the flight (black); where only blue is seen with a red rim, nothing has changed.",
    "horizons": "Errors at the end of simulations of held-out flights over their length, before (pale red) and after "
    "(blue); dashed where commands drove the rotors. The lower panels are along the axes. Grey: what the model's terms "
    "and all causes, fitted to the other flights, leave. The table rollouts_errors holds all lines.",
    "unexplained": "What no cause explains, where it lives: mean errors with standard errors (black) and the smooth "
    "function that stands for them (red), compared and held-out flights together.",
    "where": "Mean error of forces and moments where it was found, compared and held-out flights together, before "
    "(pale red) and after (blue), with standard errors of pieces of 2 s where there are enough. Shown are the places "
    "where the two differ most and where the error stands out most from these; the table forces_where holds all "
    "channels and places.",
    "spectra": "Power of the errors over frequency, before (pale red) and after (blue) the extension.",
}
