"""Parts of self-contained web pages: the document, the packed numbers, the three-dimensional view."""
