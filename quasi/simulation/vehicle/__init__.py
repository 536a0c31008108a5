"""The simulated vehicle: state layout, equations of motion, rotors, payload, inflow, sensors and wind."""
