"""The command `piezoid`: Ctrl-C is handled before anything else is loaded."""

from piezoid_cli.interrupt import install


def main() -> None:
    """Load the command line and run it."""
    install()
    from piezoid_cli.main import main as run

    run()


if __name__ == "__main__":
    main()
