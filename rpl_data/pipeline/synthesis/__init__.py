"""`rpl synthesize`: which scenes new views may be made of, their dense models, and the export."""
