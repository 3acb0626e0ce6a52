"""`python -m lensshift` is `lensshift`."""

from lensshift.cli import main

if __name__ == "__main__":
    main()
