"""Before numpy is loaded: one thread for matrix products, as a job of the workflow has."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
