"""Live use: transports, sessions, and checks of live input; `web` serves the page."""
