"""The same as `geort-drake export`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["export", *sys.argv[1:]]))
