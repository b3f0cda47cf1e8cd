// @ts-check
// Colours of the theme, as WebGL takes them.

import { token } from '../../panel.js';

/** @param {string} name of a token @returns {number[]} red, green, blue from 0 to 1 */
export const rgb = (name) => (token(name).match(/[\d.]+/g) ?? ['0', '0', '0']).slice(0, 3).map((part) => Number(part) / 255);

/** Those of the ground and the sky. */
export const surroundings = () => ({ sky: rgb('--scene-sky'), ground: rgb('--scene-ground'), grid: rgb('--scene-grid'), field: rgb('--scene-field'), line: rgb('--scene-field-line') });
