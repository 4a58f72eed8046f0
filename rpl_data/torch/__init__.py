"""PyTorch Datasets over an exported COCO folder. They need nothing else of this package's stages."""
