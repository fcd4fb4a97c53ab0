"""Runs as tables see them, and the record files that keep them without their folders."""
