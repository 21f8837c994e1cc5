"""FIL: the files that manifests list."""
