"""A campaign: settings, ledger, the ask-fly-tell loop, learning from earlier campaigns."""
