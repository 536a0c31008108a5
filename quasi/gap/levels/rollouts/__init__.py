"""Roll-outs: simulations of the held-out flights, which confirm causes and measure the gain."""
