"""Clocks of the sources of a recording: lag, rate and delays, and their standard errors."""
