"""Safety metrics of state logs, and maps fitted to driven lines: time beside error."""
