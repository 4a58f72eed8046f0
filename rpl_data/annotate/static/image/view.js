// The part of the image that is on the screen. A pixel u is at x = (u + 0.5) * zoom + left: (0, 0)
// is the centre of the top-left pixel.

import { app, clicksIn, frame, poses, scene } from "../state/store.js";

export const view = { zoom: 1, left: 0, top: 0, fitted: true };

export const toScreen = ([u, v]) => [(u + 0.5) * view.zoom + view.left, (v + 0.5) * view.zoom + view.top];
export const toImage = (x, y) => [(x - view.left) / view.zoom - 0.5, (y - view.top) / view.zoom - 0.5];
export const isInside = (u, v) => u >= -0.5 && v >= -0.5 && u < scene().width - 0.5 && v < scene().height - 0.5;
export const clicksHere = () => (poses() ? clicksIn(app.scene, frame()) : []);
