"""Programs behind the published figures.

Linear algebra uses one thread, as on the command line. More threads wait for each other at these
sizes (on a busy machine a diagnosis takes four times the processor time) and change the last
digits.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
