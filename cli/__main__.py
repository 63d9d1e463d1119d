"""The command `piezoid`: install the handler of Ctrl-C, then load the command line."""

from piezoid_cli.interrupt import install


def main() -> None:
    """Load the command line and run it."""
    install()
    from piezoid_cli.main import main as run

    run()


if __name__ == "__main__":
    main()
