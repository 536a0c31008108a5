"""Controllers and references: gains, outer loops, control allocation, setpoints over time."""
