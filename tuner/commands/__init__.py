"""One module per command group; the work is done elsewhere, here it is only asked for and shown."""
