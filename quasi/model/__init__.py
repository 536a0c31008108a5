"""The standalone model: its document, its limits, how it is built, read, extended and evaluated."""
