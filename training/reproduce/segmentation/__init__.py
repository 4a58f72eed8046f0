"""The segmentation figure: Mask R-CNN on our masks and on true ones."""
