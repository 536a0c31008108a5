"""What a simulation gets wrong, which cause it has, what the model becomes with it, and what that gains."""
