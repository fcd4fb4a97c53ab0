"""For maintainers: ``python -m tools.readme_tables`` makes the tables of README.md from results/tables."""
