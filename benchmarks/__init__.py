"""Races of polishd against its peers: ``make bench`` runs every ``bench_*.py`` here.

Such a module has one function, ``rows(progress)``, which yields a ``Row`` per comparison, usually from ``race``.
"""

import os

# Before numpy is imported: a race counts CPU seconds, and idle BLAS threads spin.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
