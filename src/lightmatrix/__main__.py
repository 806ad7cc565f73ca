"""`python -m lightmatrix`: the command line where the command is not on the path."""

from lightmatrix.cli import console

if __name__ == "__main__":
    console()
