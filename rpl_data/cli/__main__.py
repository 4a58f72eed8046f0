"""What the command `rpl` starts, and `python -m rpl_data.cli`."""

import sys


def start() -> int:
    """Run the command; Ctrl-C while its modules load is one line, too."""
    try:
        from rpl_data.cli.main import main

        return main()
    except KeyboardInterrupt:
        print("rpl: interrupted before it began", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(start())
