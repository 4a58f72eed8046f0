"""`python -m rpl_data.cli` is the command `rpl`."""

import sys

from rpl_data.cli.main import main

sys.exit(main())
