"""The same as `geort-drake live`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["live", *sys.argv[1:]]))
