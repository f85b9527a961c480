"""The only code that touches the world: settings, sources, store, socket, command line."""

import os

# Matrices here are small: a second BLAS thread only spins. Measured on a fit of 37 turns: 278 ms of CPU
# time with OpenBLAS's own choice of two threads, 78 ms with one. Must stand before numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
