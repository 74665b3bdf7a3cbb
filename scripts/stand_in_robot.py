"""The same as `geort-drake stand-in-robot`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["stand-in-robot", *sys.argv[1:]]))
