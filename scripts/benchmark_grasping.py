"""The same as `geort-drake benchmark`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["benchmark", *sys.argv[1:]]))
