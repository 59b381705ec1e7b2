"""diagnosis.html: a diagnosis' figures, page and files."""
