"""What a run of the workflow keeps beside its results: checksums of raw files, and which runs are alive."""
