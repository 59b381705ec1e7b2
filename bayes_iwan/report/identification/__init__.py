"""report.html: an identification's figures, tables and page."""
