"""The catalogue of causes, one file each. A cause is added by adding a file that defines EFFECT."""
