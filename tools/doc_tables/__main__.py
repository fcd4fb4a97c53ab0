import sys

from tools.doc_tables.command import main

sys.exit(main())
