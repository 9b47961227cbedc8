"""Programs that talk to the service: Python client, command line, web page."""
