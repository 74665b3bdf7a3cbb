"""The same as `geort-drake draw-diagram`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["draw-diagram", *sys.argv[1:]]))
