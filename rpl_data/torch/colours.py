"""Change the colours of a crop at random: light, blur and the sensor's noise."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from rpl_data.torch.augmentation import Augmentation

Image = UInt8[np.ndarray, "height width 3"]


def jittered(image: Image, augmentation: Augmentation, rng: np.random.Generator) -> Image:
    """Change gain, brightness, light, sharpness and noise at random, as far as the augmentation says."""
    import cv2

    if augmentation.gain or augmentation.offset:
        gains = rng.uniform(1 - augmentation.gain, 1 + augmentation.gain, 3)
        offset = 255 * rng.uniform(-augmentation.offset, augmentation.offset)
        table = np.clip(np.arange(256)[:, None] * gains + offset, 0, 255).astype(np.uint8)
        image = cv2.LUT(image, table.reshape(1, 256, 3))  # for speed
    if augmentation.light:
        image = relit(image, augmentation.light, rng)
    if augmentation.blur_px:
        image = _blurred(image, augmentation.blur_px * rng.uniform())
    if augmentation.noise:
        image = _noisy(image, augmentation.noise * rng.uniform(), rng)
    return image


def relit(image: Image, amount: float, rng: np.random.Generator) -> Image:
    """Bend the brightnesses by a random exponent, and shade the image along a random direction."""
    import cv2

    exponent = (1 + amount) ** rng.uniform(-1, 1)
    bent = cv2.LUT(image, (255 * (np.arange(256) / 255) ** exponent).round().astype(np.uint8))
    height, width = image.shape[:2]
    angle, strength = rng.uniform(0, 2 * np.pi), amount * rng.uniform()
    across = np.cos(angle) * np.linspace(-0.5, 0.5, width, dtype=np.float32)
    down = np.sin(angle) * np.linspace(-0.5, 0.5, height, dtype=np.float32)
    shade = (1 + strength * (down[:, None] + across)).astype(np.float32)
    shaded: Image = cv2.multiply(bent, cv2.merge([shade] * 3), dtype=cv2.CV_8U)
    return shaded


def _blurred(image: Image, sigma_px: float) -> Image:
    import cv2

    if sigma_px < 0.2:
        return image  # would change less than a grey level
    sigma_px = min(sigma_px, max(image.shape))  # beyond, all is one colour, and OpenCV fails in the end
    result: Image = cv2.GaussianBlur(image, (0, 0), sigma_px)
    return result


def _noisy(image: Image, sigma: float, rng: np.random.Generator) -> Image:
    import cv2

    grain = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(255 * sigma)
    result: Image = cv2.add(image, grain, dtype=cv2.CV_8U)
    return result
