"""The same as `geort-drake synthesize`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["synthesize", *sys.argv[1:]]))
