"""What is asked of residuals whatever they are of: mixed models, whitening, blocks drawn anew."""
