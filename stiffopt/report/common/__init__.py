"""Parts shared by all reports: page frame, figures as SVG, quantities, citations, progress."""
