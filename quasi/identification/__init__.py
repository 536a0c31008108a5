"""Forces and moments become polynomial models by stepwise regression."""
