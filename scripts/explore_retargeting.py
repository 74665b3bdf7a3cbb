"""The same as `geort-drake explore`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["explore", *sys.argv[1:]]))
