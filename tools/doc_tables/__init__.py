"""For maintainers: ``python -m tools.doc_tables`` makes the tables of README.md and docs/ from results/tables."""
