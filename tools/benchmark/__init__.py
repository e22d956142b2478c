"""What navigation costs, stage by stage, beside the thesis' method and other people's first steps (tools/bench)."""

import os

# One thread for everybody; BLAS reads this when numpy is first imported.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
