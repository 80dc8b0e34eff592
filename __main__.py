"""``python -m bough``."""

import sys

from .cli.main import main

sys.exit(main())
