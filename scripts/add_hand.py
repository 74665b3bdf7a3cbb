"""The same as `geort-drake add-hand`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["add-hand", *sys.argv[1:]]))
