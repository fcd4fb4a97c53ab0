"""A table as a document, and one writer for each format."""
