"""`python -m hebbviz` is the command line. That stands above this package, and is imported here
alone, when it is run.
"""

if __name__ == "__main__":
    from hebbviz.server.cli.main import program

    program()
