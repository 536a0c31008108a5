"""The portable model: plain data, predict, scores."""
