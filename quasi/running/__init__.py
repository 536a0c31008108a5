"""A run of the workflow: job logs, terminal output, checksums, code digests, live runs, the kernel cache."""
