"""The command line, started as `python -m hebbviz`. Only this file imports it, when it runs."""

if __name__ == "__main__":
    from hebbviz.server.cli.main import program

    program()
