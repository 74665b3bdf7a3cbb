"""The same as `geort-drake evaluate`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["evaluate", *sys.argv[1:]]))
