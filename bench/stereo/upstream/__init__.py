"""Networks as their authors published them, run from a user's own checkout and checkpoint in a process of their own."""
