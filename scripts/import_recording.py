"""The same as `geort-drake convert`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["convert", *sys.argv[1:]]))
