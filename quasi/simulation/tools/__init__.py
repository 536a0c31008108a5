"""Tools on the simulator: roll-outs, margins, reachable positions, live flight, figures, export constants."""
