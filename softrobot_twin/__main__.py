"""The commands of softrobot_twin: ``softrobot_twin COMMAND``, or ``python -m softrobot_twin``."""

import sys
from pathlib import Path

from softrobot_twin.command_line.commands import NODES, program
from softrobot_twin.errors import SoftRobotTwinError, printable_lines


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit code.

    Args:
        arguments: Words after the program's name; None for those of the process.
    """
    is_module = Path(sys.argv[0]).name == "__main__.py"
    name = "python -m softrobot_twin" if is_module else "softrobot_twin"
    words = sys.argv[1:] if arguments is None else arguments
    if words and words[0] in NODES:
        from softrobot_twin.ros import process

        return getattr(process, words[0])(words[1:])
    parser = program(name)
    if not words:
        parser.print_help(sys.stderr)
        return 2
    chosen = parser.parse_args(arguments)
    try:
        return chosen.run(chosen)
    except SoftRobotTwinError as error:
        print(f"softrobot_twin: {printable_lines(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("softrobot_twin: stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
