"""The same as `geort-drake replay`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["replay", *sys.argv[1:]]))
