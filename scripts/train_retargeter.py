"""The same as `geort-drake train`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
