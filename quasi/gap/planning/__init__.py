"""What a trajectory could reveal before it is flown, and which manoeuvres are missing."""
