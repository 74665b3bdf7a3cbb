"""The same as `geort-drake publish`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["publish", *sys.argv[1:]]))
