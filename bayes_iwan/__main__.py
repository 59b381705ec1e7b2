"""`python -m bayes_iwan`: the command line where no script is installed."""

import sys

from bayes_iwan.cli import main

sys.exit(main())
