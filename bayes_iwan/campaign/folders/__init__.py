"""Campaign folders: read, looked at, written."""
