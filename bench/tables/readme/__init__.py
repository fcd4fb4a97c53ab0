"""The tables in README.md, made from what is kept in ``results/tables``."""
