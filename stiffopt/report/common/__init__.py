"""What the reports share: page frame, figures as SVG, quantities, citations, progress."""
