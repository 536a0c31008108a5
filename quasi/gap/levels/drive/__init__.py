"""Drive: rotor speeds against commands."""
