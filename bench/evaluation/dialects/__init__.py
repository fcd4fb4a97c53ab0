"""How other systems' released evaluation code scores what a run saved; each one's rules in a file of their own."""
