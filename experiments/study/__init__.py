"""What all studies share: work in processes, files, tables, figures and pages."""
