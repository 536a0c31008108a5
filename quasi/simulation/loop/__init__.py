"""The closed loop: how it is set up, run and logged, compiled or step by step in Python."""
