"""`python -m lightmatrix`, for where the installed command is not on the path."""

from lightmatrix.cli import console

if __name__ == "__main__":
    console()
