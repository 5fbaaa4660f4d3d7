"""The file of a page; a browser does not mind what follows the document."""

from sionna_radar.report.signed_file import SignedFile

PAGE_FILE = SignedFile(command="show", before="<!-- ", after=" -->", at_end=True)
