"""Labelled datasets that trainers read: COCO and YOLO."""
