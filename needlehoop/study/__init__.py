"""From the files of runs to answers: statistics, tables, figures. No simulator, no torch."""
