"""Models fly: roll-outs from measured states."""
