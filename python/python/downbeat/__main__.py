"""``python -m downbeat`` is the command ``downbeat``."""

import sys

from downbeat.program import main

sys.exit(main())
