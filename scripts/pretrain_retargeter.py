"""The same as `geort-drake pretrain`."""

import sys

from geort_drake.cli import main

if __name__ == "__main__":
    sys.exit(main(["pretrain", *sys.argv[1:]]))
