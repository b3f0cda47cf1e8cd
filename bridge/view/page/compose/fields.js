// @ts-check
// Controls for values: one per type of setting.

import { h } from '../panel.js';

/** @typedef {{ id: string, type: string, value: any, fallback?: any, range?: [number, number], choices?: string[], label: string, describedBy?: string }} FieldOptions */

const LISTS = new Set(['bools', 'bytes', 'integers', 'doubles', 'texts']);

/** @param {any} value */
export function words(value) {
  if (value === undefined || value === null) return '';
  return typeof value === 'string' ? value : JSON.stringify(value);
}

/**
 * A control that calls `change` with a new value, or with null where it is emptied: the default then.
 * @param {FieldOptions} options
 * @param {(value: any) => void} change
 * @returns {HTMLElement}
 */
export function field({ id, type, value, fallback, range, choices, label, describedBy }, change) {
  const shared = { id, 'aria-label': label, ...(describedBy ? { 'aria-describedby': describedBy } : {}) };
  const isGiven = value !== undefined && value !== null;
  if (choices?.length) {
    const present = isGiven ? String(value) : '';
    const known = choices.includes(present) || !isGiven ? choices : [present, ...choices];
    const select = h('select', { ...shared, onchange: () => change(select.value === '' ? null : select.value) },
      h('option', { value: '' }, fallback === undefined || fallback === null ? '—' : `default: ${words(fallback)}`),
      known.map((choice) => h('option', { value: choice }, choice)));
    select.value = present;
    return select;
  }
  if (type === 'bool') {
    const select = h('select', { ...shared, onchange: () => change(select.value === '' ? null : select.value === 'true') },
      h('option', { value: '' }, fallback === undefined || fallback === null ? '—' : `default: ${fallback ? 'yes' : 'no'}`),
      h('option', { value: 'true' }, 'yes'), h('option', { value: 'false' }, 'no'));
    select.value = isGiven ? String(value) : '';
    return select;
  }
  if (type === 'integer' || type === 'double') {
    const input = h('input', {
      ...shared, type: 'text', inputmode: type === 'integer' ? 'numeric' : 'decimal', autocomplete: 'off',
      value: isGiven ? words(value) : '', placeholder: words(fallback),
      title: range ? `${range[0]} to ${range[1]}` : '',
      onchange: () => {
        const text = input.value.trim();
        const number = Number(text);
        const isWrong = text !== '' && (!Number.isFinite(number) || (type === 'integer' && !Number.isSafeInteger(number)) ||
          (range !== undefined && (number < range[0] || number > range[1])));
        input.setAttribute('aria-invalid', String(isWrong));
        input.setCustomValidity(isWrong ? (range ? `a number from ${range[0]} to ${range[1]}` : type === 'integer' ? 'a whole number' : 'a number') : '');
        if (isWrong) input.reportValidity();
        else change(text === '' ? null : number);
      },
    });
    return input;
  }
  if (LISTS.has(type)) {
    const show = (/** @type {any} */ list) => Array.isArray(list) ? list.map((entry) => words(entry)).join(type === 'texts' ? '\n' : ', ') : '';
    const isText = type === 'texts';
    const take = () => {
      const parts = control.value.split(isText ? '\n' : /[,\s]+/).map((part) => part.trim()).filter((part) => part !== '');
      if (parts.length === 0) return change(null);
      const values = isText ? parts : parts.map((part) => type === 'bools' ? ({ true: true, false: false })[part] : Number(part));
      const isWrong = values.some((entry) => entry === undefined || (typeof entry === 'number' && !Number.isFinite(entry)));
      control.setAttribute('aria-invalid', String(isWrong));
      if (!isWrong) change(values);
    };
    /** @type {HTMLInputElement | HTMLTextAreaElement} */
    const control = isText
      ? h('textarea', { ...shared, rows: Math.min(6, Math.max(2, (Array.isArray(value) ? value : fallback ?? []).length)), placeholder: show(fallback) || 'one per line', spellcheck: false, onchange: take })
      : h('input', { ...shared, type: 'text', placeholder: show(fallback) || 'separated by commas', autocomplete: 'off', onchange: take });
    control.value = isGiven ? show(value) : '';
    return control;
  }
  const input = h('input', {
    ...shared, type: 'text', value: isGiven ? words(value) : '', placeholder: words(fallback), autocomplete: 'off', spellcheck: false,
    onchange: () => change(input.value === '' ? null : input.value),
  });
  return input;
}
