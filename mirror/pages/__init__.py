"""What all pages share: a layout, one style sheet, parts such as tables, and the function that renders a template."""
