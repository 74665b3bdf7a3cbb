"""The same as `geort-drake capture`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["capture", *sys.argv[1:]]))
