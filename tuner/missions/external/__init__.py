"""Own missions: a file says what a mission takes, a request goes in, a result comes out."""
