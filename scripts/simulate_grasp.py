"""The same as `geort-drake grasp`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["grasp", *sys.argv[1:]]))
