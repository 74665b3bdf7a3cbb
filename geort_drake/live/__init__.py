"""Live use: transports, session, checks of live input; `web`, the page's server."""
