"""Files for elsewhere: the authors' and gatetune's settings, routes, missions as a table; and what is read from a mission's directory."""
