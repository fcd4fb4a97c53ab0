import sys

from tools.readme_tables.command import main

sys.exit(main())
