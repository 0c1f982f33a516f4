"""Property tests try the same examples on every machine; with HYPOTHESIS_PROFILE=explore they look for new ones."""

import os

from hypothesis import Phase, settings

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: every process of the tests has one core
    os.environ.setdefault(threads, "1")

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None, max_examples=500)
settings.register_profile("mutation", derandomize=True, deadline=None, phases=[Phase.explicit, Phase.generate])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))
