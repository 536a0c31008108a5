"""Forces and moments: what causes forces and moments have that the model lacks, and what they are worth."""
