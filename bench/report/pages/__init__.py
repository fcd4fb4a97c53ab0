"""The report: pages that open from disk, made from run folders."""
