"""What piezoid is measured by, against what its authors did not write.

One thread of linear algebra, as on the command line: at these sizes threads wait for each other
(a diagnosis beside other work takes four times the processor) and change last digits.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
