"""Figures made from run folders, as a paper has them."""
