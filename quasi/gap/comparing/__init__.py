"""Two flights, or two models on the same flights: what differs by more than the spread explains."""
