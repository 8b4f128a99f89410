"""One thread for JAX in every benchmark, as PyTorch has: threads that wait count as processor time, and weights depend on their number."""

import os

os.environ.setdefault("PJRT_NPROC", "1")
