"""The same as `geort-drake check-recording`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["check-recording", *sys.argv[1:]]))
