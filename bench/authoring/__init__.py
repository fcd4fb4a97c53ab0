"""For the author of a plugin: a first file to start from, and a check of the contract before it costs compute."""
