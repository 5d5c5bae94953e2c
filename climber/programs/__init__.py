"""Every program a solver is handed: mathematical (Drake) and logic (clingo). No search code here."""
