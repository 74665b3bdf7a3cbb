"""The same as `geort-drake refit`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["refit", *sys.argv[1:]]))
