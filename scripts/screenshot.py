"""The same as `geort-drake screenshot`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["screenshot", *sys.argv[1:]]))
