"""`python -m geort_drake`, the same as `geort-drake`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main())
